// Reads a robot of OPC 40010-1 as a client of others does: by browse names, with node-opcua. Prints one JSON object.
import {
  AttributeIds,
  browseAll,
  makeBrowsePath,
  MessageSecurityMode,
  OPCUAClient,
  SecurityPolicy,
} from "node-opcua-client";

const DI = "http://opcfoundation.org/UA/DI/";
const ROBOTICS = "http://opcfoundation.org/UA/Robotics/";
const [endpoint] = process.argv.slice(2);
const client = OPCUAClient.create({
  securityMode: MessageSecurityMode.None,
  securityPolicy: SecurityPolicy.None,
  endpointMustExist: false,
  connectionStrategy: { maxRetry: 0 },
});

async function readRobot(session) {
  const namespaces = await session.readNamespaceArray();
  const di = namespaces.indexOf(DI);
  const ir = namespaces.indexOf(ROBOTICS);
  const find = async (start, path) => {
    const { statusCode, targets } = await session.translateBrowsePath(makeBrowsePath(start, path));
    if (!statusCode.isGood()) throw new Error(`${path}: ${statusCode.name}`);
    return targets[0].targetId;
  };
  const read = async (node, attributeId = AttributeIds.Value) =>
    (await session.read({ nodeId: node, attributeId })).value.value;
  const children = async (node) => (await browseAll(session, node)).references ?? [];

  const [system] = (await children(`ns=${di};i=5001`)).filter((each) => each.browseName.namespaceIndex !== 0);
  const devices = await find(system.nodeId, `/${ir}:MotionDevices`);
  const [device] = await children(devices);
  const axes = [];
  for (const axis of await children(await find(device.nodeId, `/${ir}:Axes`))) {
    const position = await find(axis.nodeId, `/${di}:ParameterSet/${ir}:ActualPosition`);
    const unit = await find(position, "/0:EngineeringUnits");
    axes.push({
      name: axis.browseName.name,
      value: await read(position),
      unit: (await read(unit)).displayName.text,
      profile: await read(await find(axis.nodeId, `/${ir}:MotionProfile`)),
    });
  }
  const [safety] = await children(await find(system.nodeId, `/${ir}:SafetyStates`));
  const safetyValue = async (name) => read(await find(safety.nodeId, `/${di}:ParameterSet/${ir}:${name}`));
  return {
    axes,
    serial: await read(await find(device.nodeId, `/${di}:SerialNumber`)),
    override: await read(await find(device.nodeId, `/${di}:ParameterSet/${ir}:SpeedOverride`)),
    mode: await safetyValue("OperationalMode"),
    emergencyStop: await safetyValue("EmergencyStop"),
    protectiveStop: await safetyValue("ProtectiveStop"),
  };
}

const found = await client.withSessionAsync(endpoint, readRobot);
console.log(JSON.stringify(found));
